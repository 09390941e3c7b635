// Counts the collections of the garbage collector while a link ticks: with a small nursery, none means that nothing is
// allocated. Then tries whether what must not allocate would have been seen.
using System;
using System.Threading;
using Hapticnet;

internal sealed class Still : IHand
{
    internal double Deepest, Largest;
    private int _tick;

    public void Read(double[] positionM)
    {
        positionM[0] = 0.0125 * (1.0 - Math.Cos(_tick++ * 0.005));
        Deepest = Math.Max(Deepest, positionM[0]);
    }

    public void Apply(double[] forceN)
    {
        Largest = Math.Max(Largest, forceN[0]);
    }
}

internal sealed class Wall : IScene
{
    public void Touch(double[] positionM, double[] forceN)
    {
        forceN[0] = Math.Max(0.0, 300.0 * (positionM[0] - 0.01));
    }
}

internal static class Steady
{
    private static int Collections()
    {
        int count = 0;
        for (int generation = 0; generation <= GC.MaxGeneration; generation++)
            count += GC.CollectionCount(generation);
        return count;
    }

    private static void Measure(string what, MasterLink master, int ms)
    {
        long ticks = master.Ticks, missed = master.MissedTicks;
        int before = Collections();
        Thread.Sleep(ms);
        int collections = Collections() - before;
        Console.WriteLine("{0}: {1} collections in {2} ticks, {3} missed", what, collections, master.Ticks - ticks,
            master.MissedTicks - missed);
    }

    private static void Main(string[] arguments)
    {
        int port = int.Parse(arguments[0]), ms = int.Parse(arguments[1]);
        var hand = new Still();
        using (var master = new MasterLink("127.0.0.1", port, new Request(), hand))
        {
            Thread.Sleep(1000);
            Measure("master", master, ms);
            Console.WriteLine("state {0} force {1:0.0}", master.State, hand.Largest);
        }
        using (var slave = new SlaveLink("127.0.0.1", 0, "wall", 1, new Wall()))
        using (var master = new MasterLink("127.0.0.1", slave.Port, new Request(), hand))
        {
            Thread.Sleep(1000);
            Measure("both", master, ms);
            Console.WriteLine("state {0}", master.State);
        }
        int before = Collections();
        for (int i = 0; i < 5000; i++)
            GC.KeepAlive(new byte[16]);
        Console.WriteLine("seen: {0}", Collections() - before > 0);
    }
}
